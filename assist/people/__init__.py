"""How people decide: what they can do, how they choose, take advice and come to trust it, and the belief in them."""
