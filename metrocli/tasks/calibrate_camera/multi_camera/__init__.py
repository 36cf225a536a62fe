"""Several cameras fixed to each other: `images` -> `start` -> `system` -> adjustment of shared.images -> `report`."""
