"""`teleop report`: what folders hold, as tables on the terminal and as one page of HTML that needs nothing else."""
