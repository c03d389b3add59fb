"""The live assistant: one team of real people, action by action."""
