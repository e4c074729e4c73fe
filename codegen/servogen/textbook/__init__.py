"""The pseudo-inverse as a textbook has it: what the generated solver is held against."""
