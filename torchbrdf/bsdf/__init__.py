"""Layer 2: the reflection models. One model, one file, which is its manual page."""
