"""Record a trial: any number of devices into one file, whatever happens to one of them."""
