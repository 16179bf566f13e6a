"""What is known of a bounder: the certificate, its words, how it is filled in, and whether a stored one can be true."""
