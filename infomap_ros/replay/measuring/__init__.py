"""Images of a bag or of live topics into range clouds and views."""
