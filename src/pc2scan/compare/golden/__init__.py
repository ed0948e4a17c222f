"""Golden cases: folders with an input, parameters and the expected output, against which conversions are checked."""
