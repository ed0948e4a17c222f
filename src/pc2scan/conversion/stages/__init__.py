"""The stages between decoding and projecting: arrays in, arrays and named counts out."""
