// Whether arithmetic is the same on every processor, or the fastest that this one has.
#pragma once

bool stillroom_is_reproducible();
