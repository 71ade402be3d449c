"""Ma 2018, its tables and figures, one script for each part; `python -m experiments.ma2018` runs them all."""
