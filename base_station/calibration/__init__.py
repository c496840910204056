"""Camera calibration: boards to print, views of them, the camera that explains the views (see README.md here)."""
