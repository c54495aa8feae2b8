"""Images, shots of images, and folders of shots."""
