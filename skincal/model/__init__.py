"""What there is: readings, the scene, its skin and layout, and the error that ends in a sentence."""
