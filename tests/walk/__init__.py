"""How far a plain capture walks through the program, and what the program weighs."""
