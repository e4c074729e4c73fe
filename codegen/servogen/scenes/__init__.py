"""The built-in scenes: one small file each, which defines `scene`."""
