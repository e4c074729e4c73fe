"""One self-contained page: what was generated, how right it is, how it moves, how fast it runs."""
