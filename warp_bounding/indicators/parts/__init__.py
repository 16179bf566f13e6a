"""Parts of shapes: what lies in a box, beyond the object, or is one of the pieces that a shape is made of."""
