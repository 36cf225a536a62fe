"""Errors that readings taken together share, and the covariance that counts them."""
