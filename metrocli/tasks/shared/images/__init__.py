"""Measurements in images: sightings, their adjustment, simulation and tables (calibrate-camera, align-part)."""
