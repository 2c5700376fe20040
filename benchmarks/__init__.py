"""usdskin and its peers, side by side."""
