"""What the camera sees: meshes, cameras, G-buffers and who is in whose shadow."""
