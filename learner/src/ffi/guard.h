// The boundary of C++: exceptions become error texts.
#pragma once

#include <c10/util/Exception.h>
#include <cstring>
#include <exception>

inline void explain(const char *reason, char *message, size_t capacity) {
    std::strncpy(message, reason, capacity - 1);
    message[capacity - 1] = 0;
}

// Runs `body`. Returns 0, or 1 with the reason in `message`; no exception leaves.
template <typename Body> int guarded(char *message, size_t capacity, Body body) {
    try {
        body();
        return 0;
    } catch (const c10::Error &error) {
        // Without the call stack, which does not help a user.
        explain(error.what_without_backtrace(), message, capacity);
    } catch (const std::exception &error) {
        explain(error.what(), message, capacity);
    } catch (...) {
        explain("something was thrown that is no exception", message, capacity);
    }
    return 1;
}
