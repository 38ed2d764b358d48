"""Pictures of episodes and runs: `frames` with OpenCV, `figures` with matplotlib."""
