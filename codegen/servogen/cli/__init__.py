"""The command: one file a subcommand, `main` gathers them."""
