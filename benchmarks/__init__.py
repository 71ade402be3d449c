"""Speed figures and their ratios, all from one run on one machine."""
