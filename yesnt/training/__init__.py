"""Training of the embedded model: synthetic images of people and objects with known materials, and the optimisation."""
