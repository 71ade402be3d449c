"""AIEZ (Zhang, Guo and Liu): its figures and table, and what was made of it."""
