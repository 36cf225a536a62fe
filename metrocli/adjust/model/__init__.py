"""What is adjusted: quantities, blocks, chains of links, observations, and groups of these."""
