"""`ground-tools fly`: arm, take off, upload, start and land one or many vehicles, over MAVSDK."""
