"""Parts of examples/height_field.py: a surface of mirrors and rays on it; directions by bins."""
