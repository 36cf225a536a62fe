"""Starting values of a network: set-ups joined over the points that they share."""
