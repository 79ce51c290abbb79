// Several processes of one machine as a process group of libtorch's c10d: a file is the rendezvous, Gloo is the
// transport. tch does not bind c10d, because libtorch's C interface does not export it. The wheels contain Gloo without
// its headers; `gloo/` declares the types that c10d's header names.

#define USE_C10D_GLOO

#include "guard.h"
#include <torch/csrc/distributed/c10d/FileStore.hpp>
#include <torch/csrc/distributed/c10d/ProcessGroupGloo.hpp>

#include <dirent.h>
#include <linux/filter.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <cstdlib>

struct Group {
    c10::intrusive_ptr<c10d::FileStore> store;
    c10::intrusive_ptr<c10d::ProcessGroupGloo> gloo;
};

// Everybody has met: whoever knocks now is none of us. Gloo listens on as long as the group lives, accepts whoever comes,
// and ends the process when there are no descriptors left. It gives us neither a way to close its socket nor its number,
// so the kernel is told to drop what comes in on each TCP socket of this process that listens. Connections that exist
// are not concerned.
static void close_doors() {
    DIR *open_files = opendir("/proc/self/fd");
    TORCH_CHECK(open_files, "cannot read /proc/self/fd");
    sock_filter drop_all = BPF_STMT(BPF_RET | BPF_K, 0);
    const sock_fprog filter{1, &drop_all};
    while (const dirent *entry = readdir(open_files)) {
        const int descriptor = std::atoi(entry->d_name);
        const auto option = [&](int name) {
            int value = 0;
            socklen_t size = sizeof value;
            return getsockopt(descriptor, SOL_SOCKET, name, &value, &size) == 0 ? value : -1;
        };
        const int domain = option(SO_DOMAIN);
        if ((domain == AF_INET || domain == AF_INET6) && option(SO_PROTOCOL) == IPPROTO_TCP && option(SO_ACCEPTCONN) == 1) {
            setsockopt(descriptor, SOL_SOCKET, SO_ATTACH_FILTER, &filter, sizeof filter);
        }
    }
    closedir(open_files);
}

// Of every function: returns 0, or 1 with the reason in `message`; no exception leaves.

// Joins a group of `size` members whose rendezvous is the file `path`; each member has its own rank. All must join
// within `joining_ms`; afterwards an operation fails after `patience_ms`. The caller owns the group and closes it.
extern "C" int stillroom_group_open(const char *path, int rank, int size, int64_t joining_ms, int64_t patience_ms,
                                    Group **group, char *message, size_t capacity) {
    return guarded(message, capacity, [&] {
        const std::chrono::milliseconds joining(joining_ms), patience(patience_ms);
        auto store = c10::make_intrusive<c10d::FileStore>(path, size);
        store->setTimeout(joining);
        auto options = c10d::ProcessGroupGloo::Options::create(joining);
        options->devices = {c10d::ProcessGroupGloo::createDeviceForHostname("127.0.0.1")};
        // One operation at a time.
        options->threads = 1;
        auto gloo = c10::make_intrusive<c10d::ProcessGroupGloo>(store, rank, size, options);
        gloo->setTimeout(patience);
        close_doors();
        *group = new Group{std::move(store), std::move(gloo)};
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
