"""The networks of policies, and the policies that they make."""
