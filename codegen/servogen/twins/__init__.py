"""Controllers to call from Python: the textbook reference, the compiled C, and the 50-digit truth."""
