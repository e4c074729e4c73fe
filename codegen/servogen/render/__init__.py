"""Module -> source files: templates and a printer that decide nothing."""
