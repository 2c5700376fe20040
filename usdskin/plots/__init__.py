"""Draw what the steps have written, for print and screen."""
