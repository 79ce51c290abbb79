// Several processes as a process group of libtorch's c10d: Gloo is the transport; the rendezvous is a file of one
// machine, or a TCPStore in the first member. tch does not bind c10d, because libtorch's C interface does not export it.
// The wheels contain Gloo without its headers; `gloo/` declares the types that c10d's header names.

#define USE_C10D_GLOO

#include "guard.h"
#include <torch/csrc/distributed/c10d/FileStore.hpp>
#include <torch/csrc/distributed/c10d/PrefixStore.hpp>
#include <torch/csrc/distributed/c10d/ProcessGroupGloo.hpp>
#include <torch/csrc/distributed/c10d/TCPStore.hpp>

#include <dirent.h>
#include <linux/filter.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <algorithm>
#include <cstdlib>
#include <mutex>
#include <optional>
#include <set>

// c10d's flight recorder notes every operation with a call stack, for a dump that nothing here asks for. It is one for
// the process, and groups that write to it from two threads at once corrupt its table (pytorch/pytorch#179449): the
// tests have two groups in a process. The recorder reads the variable once, when the first group is made.
static void keep_no_flight_recorder() {
    static const int set = setenv("TORCH_FR_BUFFER_SIZE", "0", 1);
    TORCH_CHECK(set == 0, "no room in the environment");
}

// A socket of this process. Its number alone can be another one's by tomorrow.
struct Door {
    int descriptor;
    ino_t inode;
    bool operator<(const Door &other) const {
        return std::pair(descriptor, inode) < std::pair(other.descriptor, other.inode);
    }
};

struct Group {
    c10::intrusive_ptr<c10d::Store> store;
    c10::intrusive_ptr<c10d::ProcessGroupGloo> gloo;
};

// The sockets of this process that listen at TCP.
static std::set<Door> open_doors() {
    DIR *open_files = opendir("/proc/self/fd");
    TORCH_CHECK(open_files, "cannot read /proc/self/fd");
    std::set<Door> doors;
    while (const dirent *entry = readdir(open_files)) {
        const int descriptor = std::atoi(entry->d_name);
        const auto option = [&](int name) {
            int value = 0;
            socklen_t size = sizeof value;
            return getsockopt(descriptor, SOL_SOCKET, name, &value, &size) == 0 ? value : -1;
        };
        struct stat status;
        if (option(SO_PROTOCOL) == IPPROTO_TCP && option(SO_ACCEPTCONN) == 1 && fstat(descriptor, &status) == 0) {
            doors.insert({descriptor, status.st_ino});
        }
    }
    closedir(open_files);
    return doors;
}

// A device of Gloo's on `address`, and the socket at which it listens there. Gloo does not name that socket, but opens
// it while it makes the device: so it is the one that is new afterwards. If another thread opened one at the same
// moment, there are two, and another device is made.
static std::pair<std::shared_ptr<::gloo::transport::Device>, Door> make_device(const char *address) {
    // Two groups of one process must not take each other's sockets for their own.
    static std::mutex one_at_a_time;
    const std::lock_guard<std::mutex> turn(one_at_a_time);
    for (int attempt = 0; attempt < 100; ++attempt) {
        const auto before = open_doors();
        auto device = c10d::ProcessGroupGloo::createDeviceForHostname(address, /*lazyInit=*/false);
        const auto after = open_doors();
        std::vector<Door> opened;
        std::set_difference(after.begin(), after.end(), before.begin(), before.end(), std::back_inserter(opened));
        TORCH_CHECK(!opened.empty(), "Gloo's device does not listen");
        if (opened.size() == 1) {
            return {std::move(device), opened[0]};
        }
    }
    TORCH_CHECK(false, "other threads open sockets all the time: which one is Gloo's cannot be told");
}

static Door door_of(int descriptor) {
    struct stat status;
    TORCH_CHECK(fstat(descriptor, &status) == 0, "there is no socket ", descriptor);
    return {descriptor, status.st_ino};
}

// This member is connected to all others: a device that is not lazy waits for each. So every later connection is a
// stranger's. Gloo and the store listen as long as the group lives, and accept everybody until there are no descriptors
// left, which ends the process. They cannot close their sockets, so the kernel is told to drop what comes in there.
// Connections that exist are not concerned. A kernel that knows no such filters (that of some sandboxes) leaves the door
// open.
static void close_door(const Door &door) {
    sock_filter drop_all = BPF_STMT(BPF_RET | BPF_K, 0);
    const sock_fprog filter{1, &drop_all};
    struct stat status;
    if (fstat(door.descriptor, &status) == 0 && status.st_ino == door.inode) {
        setsockopt(door.descriptor, SOL_SOCKET, SO_ATTACH_FILTER, &filter, sizeof filter);
    }
}

// The socket of the store is the orchestrator's, and the same at each start.
static void open_door(const Door &door) {
    const int unused = 0;
    // It fails where there is no filter.
    setsockopt(door.descriptor, SOL_SOCKET, SO_DETACH_FILTER, &unused, sizeof unused);
}

// Joins the group that meets in `store`; Gloo listens on `address` alone.
static Group *join(c10::intrusive_ptr<c10d::Store> store, const char *address, int rank, int size, int64_t joining_ms,
                   int64_t patience_ms) {
    const std::chrono::milliseconds joining(joining_ms), patience(patience_ms);
    store->setTimeout(joining);
    auto options = c10d::ProcessGroupGloo::Options::create(joining);
    auto [device, door] = make_device(address);
    options->devices = {std::move(device)};
    // One operation at a time.
    options->threads = 1;
    auto gloo = c10::make_intrusive<c10d::ProcessGroupGloo>(store, rank, size, options);
    gloo->setTimeout(patience);
    close_door(door);
    return new Group{std::move(store), std::move(gloo)};
}

// Of every function: returns 0, or 1 with the reason in `message`; no exception leaves.

// Joins a group of `size` members whose rendezvous is the file `path`; each member has its own rank. All must join
// within `joining_ms`; afterwards an operation fails after `patience_ms`. The caller owns the group and closes it.
extern "C" int stillroom_group_open(const char *path, int rank, int size, int64_t joining_ms, int64_t patience_ms,
                                    Group **group, char *message, size_t capacity) {
    return guarded(message, capacity, [&] {
        keep_no_flight_recorder();
        auto store = c10::make_intrusive<c10d::FileStore>(path, size);
        *group = join(std::move(store), "127.0.0.1", rank, size, joining_ms, patience_ms);
    });
}

// Joins a group of `size` members of several machines, whose rendezvous is the first member's store at `host`:`port`.
// `listener`: the first member's descriptor of the socket that listens there already; others give a negative number.
// All keys begin with `key`. `address`: this machine's own, on which Gloo listens. Otherwise as `stillroom_group_open`.
extern "C" int stillroom_group_meet(const char *host, uint16_t port, int listener, const char *key, const char *address,
                                    int rank, int size, int64_t joining_ms, int64_t patience_ms, Group **group,
                                    char *message, size_t capacity) {
    return guarded(message, capacity, [&] {
        keep_no_flight_recorder();
        c10d::TCPStoreOptions options;
        options.port = port;
        options.isServer = listener >= 0;
        // Gloo's own meeting waits for all.
        options.waitWorkers = false;
        options.timeout = std::chrono::milliseconds(joining_ms);
        std::optional<Door> door;
        if (listener >= 0) {
            options.masterListenFd = listener;
            door = door_of(listener);
            open_door(*door);
        }
        auto tcp = c10::make_intrusive<c10d::TCPStore>(host, options);
        auto store = c10::make_intrusive<c10d::PrefixStore>(key, std::move(tcp));
        *group = join(std::move(store), address, rank, size, joining_ms, patience_ms);
        // All are connected to the store, too: Gloo's addresses are in it.
        if (door) {
            close_door(*door);
        }
    });
}

extern "C" void stillroom_group_close(Group *group) { delete group; }

// Replaces a tensor on the CPU by its sum over all; the same bits everywhere.
extern "C" int stillroom_group_sum(Group *group, const at::Tensor *tensor, char *message, size_t capacity) {
    return guarded(message, capacity, [&] {
        std::vector<at::Tensor> tensors{*tensor};
        group->gloo->allreduce(tensors, c10d::AllreduceOptions())->wait();
    });
}

// Replaces a tensor on the CPU by the first member's, of the same size and kind.
extern "C" int stillroom_group_broadcast(Group *group, const at::Tensor *tensor, char *message, size_t capacity) {
    return guarded(message, capacity, [&] {
        std::vector<at::Tensor> tensors{*tensor};
        group->gloo->broadcast(tensors, c10d::BroadcastOptions())->wait();
    });
}

// Sends a tensor on the CPU to another, who receives one of the same size and kind.
extern "C" int stillroom_group_send(Group *group, const at::Tensor *tensor, int to, char *message, size_t capacity) {
    return guarded(message, capacity, [&] {
        std::vector<at::Tensor> tensors{*tensor};
        group->gloo->send(tensors, to, 0)->wait();
    });
}

extern "C" int stillroom_group_receive(Group *group, const at::Tensor *tensor, int from, char *message,
                                       size_t capacity) {
    return guarded(message, capacity, [&] {
        std::vector<at::Tensor> tensors{*tensor};
        group->gloo->recv(tensors, from, 0)->wait();
    });
}

// Writes a note that all can read, once.
extern "C" int stillroom_group_note(Group *group, const char *key, const uint8_t *bytes, size_t length, char *message,
                                    size_t capacity) {
    return guarded(message, capacity,
                   [&] { group->store->set(key, std::vector<uint8_t>(bytes, bytes + length)); });
}

// Whether a note has been written.
extern "C" int stillroom_group_noted(Group *group, const char *key, bool *noted, char *message, size_t capacity) {
    return guarded(message, capacity, [&] { *noted = group->store->check({key}); });
}

// Waits for a note of `length` bytes and reads it.
extern "C" int stillroom_group_read(Group *group, const char *key, uint8_t *bytes, size_t length, char *message,
                                    size_t capacity) {
    return guarded(message, capacity, [&] {
        const auto note = group->store->get(key);
        TORCH_CHECK(note.size() == length, "note ", key, " has ", note.size(), " bytes, not ", length);
        std::memcpy(bytes, note.data(), length);
    });
}
