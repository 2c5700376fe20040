"""Stage to arrays, arrays to pictures."""
