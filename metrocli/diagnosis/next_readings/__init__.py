"""What to measure next: the readings that best tell apart what is indistinct, or show what cannot be seen."""
