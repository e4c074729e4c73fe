"""What several folders of tests share: random programs, random scenes, C compilers."""
