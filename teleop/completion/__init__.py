"""`teleop completion`: a script with which bash, zsh or fish completes what is typed behind `teleop`."""
