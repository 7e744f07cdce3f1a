"""Files from outside and back: pictures, saved values, and what any file may claim."""
