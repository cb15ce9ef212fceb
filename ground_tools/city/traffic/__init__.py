"""What is flown over a city: demand that is drawn, and flights of others."""
