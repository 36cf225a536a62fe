"""Diagnosis: what the model of a job gets wrong, why, and what a correction gains. It knows no instrument."""
