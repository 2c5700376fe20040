"""Which lamp lights what, where a scene has lamps of several kinds."""
