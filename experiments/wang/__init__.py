"""Figures and statements of Wang 2018, the published one beside ours."""
