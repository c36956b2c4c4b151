"""`teleop doctor`: what is installed and kept, and what this machine gives a live end, each with what to type."""
