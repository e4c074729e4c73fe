"""What a user writes: mechanism, constraints, parameters, references, scene."""
