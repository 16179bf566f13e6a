"""The configurations in which an arm collides, as a shape: bodies, joints, and certified answers over boxes of joint values."""
