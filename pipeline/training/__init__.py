"""From demonstrations to a policy: networks, methods, training, evaluation."""
