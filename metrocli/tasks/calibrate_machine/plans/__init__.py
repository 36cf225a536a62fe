"""What planned measurements of each method will determine, and how they are proposed."""
