"""The whole chain on a set, against its truth."""
