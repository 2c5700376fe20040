"""Judge: virtual photographs of known light, and how far a reproduction is from the truth."""
