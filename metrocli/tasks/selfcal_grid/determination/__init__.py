"""What views leave undetermined: patterns of machine errors, and what would determine them."""
