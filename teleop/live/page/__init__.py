"""`teleop demo --page`: a scene that runs live is shown in a browser, and turned there while it runs."""
