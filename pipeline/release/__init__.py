"""The release of datasets: card, statistics, pictures and Croissant, then the way to the Hub."""
