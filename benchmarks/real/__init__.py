"""Known effects left out of real measurements, or planted into them, judged by adjustments that share nothing with ours."""
