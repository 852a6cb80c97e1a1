"""The gates of the validation: a family of gates is a file, a gate is a record in it; `register` has them all."""
