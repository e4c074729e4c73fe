"""Program -> Program: the passes, in the order that works, legality checked around each."""
