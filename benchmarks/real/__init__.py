"""Known effects left out of real measurements, or planted into them, judged by adjustments with code of their own."""
