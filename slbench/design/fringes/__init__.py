"""Pattern design (thesis chapter 4): which fringes to project."""
