"""Layer 2: the lights. One kind, one file."""
