"""Measurements in images for calibrate-camera and align-part: sightings, adjustment, simulation and tables.

`target_list` and `sightings` (read, or found in images) -> `adjustment` (robust start, outliers, noise) with
`eccentricity` -> `tables`; `places` has effects that both share, `camera_parameters` what a calibration hands on.
"""
