"""Scene -> Formulation: S, z, A, B as SX, each with its equation."""
