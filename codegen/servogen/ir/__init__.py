"""The intermediate representation: operations, programs, lowering from SX, interpreters, rounding bounds."""
