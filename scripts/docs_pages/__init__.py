"""What the pages of docs/ are made with: the site, and pictures of navbake's own pages."""
