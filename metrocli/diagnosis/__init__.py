"""Diagnosis: what the model of a job gets wrong, why, and the gain of mending it; it knows no instrument."""
