"""What every node has: parameters, quality of service, workers, health, how it runs."""
