"""Measurements in images for calibrate-camera and align-part: sightings, adjustment, simulation and tables."""
