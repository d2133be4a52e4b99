"""Makes the embedded model: pictures of people and things with known materials, and the training on them."""
