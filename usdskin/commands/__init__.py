"""The commands, one module per group. At import they load click and nothing heavy."""
