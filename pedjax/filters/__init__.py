"""Filters: strapdown mechanisation, the 15-state error covariance, and its measurement updates."""
