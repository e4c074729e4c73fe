"""What happens between the kernels of a scene, as typed steps."""
