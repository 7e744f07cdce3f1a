"""Layer 3: the reflection equation, one effect a file. A plan decides which of them exist."""
