"""Several people and one robot: what a policy is given, the policies, and the people from whom teams are drawn."""
