"""What tests share: datasets, policies and runs to test with, and ways to damage them."""
