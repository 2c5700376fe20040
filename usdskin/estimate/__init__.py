"""What the light and the skin are, estimated from what was captured and measured."""
