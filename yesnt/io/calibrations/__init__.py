"""Calibrations of other programs: COLMAP, nerfstudio, Qualisys and OpenCV, each as the document of `cameras.json`."""
