"""Many instances: each solved, recorded and resumed."""
