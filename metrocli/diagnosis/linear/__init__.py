"""The linearised adjustment, and candidate effects that could be added to it: their signatures and score tests."""
