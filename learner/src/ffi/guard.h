// Where C++ ends: what was thrown becomes text.
#pragma once

#include <cstring>
#include <exception>

// Runs `body`. Returns 0, or 1 with the reason in `message`; no exception leaves.
template <typename Body> int guarded(char *message, size_t capacity, Body body) {
    try {
        body();
        return 0;
    } catch (const std::exception &error) {
        std::strncpy(message, error.what(), capacity - 1);
        message[capacity - 1] = 0;
        return 1;
    }
}
