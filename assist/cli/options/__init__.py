"""Options that several commands share, and what is set up from them."""
