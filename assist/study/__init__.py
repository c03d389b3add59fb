"""Studies: what is to be done, its carrying out, and what was found (extra `study`)."""
