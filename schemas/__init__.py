"""The usdSkin schema."""
