"""Images that contradict the others: `strange` targets, points and orders, and images that a viewer `turned`."""
