"""The vehicle in real time on UDP and TCP (`sitl-mocks serve`): command line, ports and fault input."""
