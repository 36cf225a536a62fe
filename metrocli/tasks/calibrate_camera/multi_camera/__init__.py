"""Several cameras fixed to each other: images of one instant are one sighting of the rig.

`start`, from each calibrated by itself -> `system` -> adjustment of shared.images -> `report`, with the doubts that
`alone` finds in each camera. `paired` tries a job for one camera as one for several; `truth` is for simulation.
"""
