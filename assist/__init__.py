"""From the exact cost-to-go to a robot that assists a team."""
