"""The arithmetic: NumPy arrays in, NumPy arrays out."""
