"""Laws: the simplest sums of terms that explain structure for which no effect is known."""
