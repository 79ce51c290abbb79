// Stands in for Gloo's header of this name: c10d's header wants it to exist.
#pragma once
