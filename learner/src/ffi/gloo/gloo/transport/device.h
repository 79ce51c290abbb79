// As much of Gloo's header of this name as c10d's header needs: pointers.
#pragma once

namespace gloo::transport {
class Device;
class UnboundBuffer;
} // namespace gloo::transport
