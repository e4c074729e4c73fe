"""What is found out about a scene on the way: Q and the weight, reach, noise. Errors and remarks come of it."""
