// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/server/lossy_disk.h"

#include <dlfcn.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdarg>
#include <fstream>
#include <regex>
#include <span>
#include <stdexcept>
#include <tuple>
#include <utility>

namespace spherule::server::test {

namespace {

namespace fs = std::filesystem;

using Bytes = std::shared_ptr<const std::string>;

using Names = LossyDisk::Names;
using Contents = LossyDisk::Contents;

/// A file or folder, whatever its names: as it is, and as it was when it was last synchronised.
struct Inode {
  int held = -1;  // a descriptor, lest its number be given to another
  bool is_folder = false;
  Bytes there, synced;
  std::int64_t time = 0, synced_time = 0;  // ns
  std::map<std::string, ino_t> lists, synced_lists;
};

std::int64_t time_of(const struct stat& status) {
  return std::int64_t{status.st_mtim.tv_sec} * 1'000'000'000 + status.st_mtim.tv_nsec;
}

std::string masked(const std::string& path) { return std::regex_replace(path, std::regex("[0-9a-f]{8,}"), "#"); }

constexpr std::array kinds_of_contents = {Contents::synced, Contents::all, Contents::torn};
constexpr std::span<const Contents> whole_files(kinds_of_contents.begin(), 2);
constexpr std::span<const Contents> torn_ones_too(kinds_of_contents);

bool is_left_out(const std::string& name) { return name.ends_with("-shm"); }

}  // namespace

struct LossyDisk::State {
  State(fs::path folder, std::set<std::string> without) : root(std::move(folder)), ignored(std::move(without)) {
    top = scan(root, {});
    for (auto& [number, inode] : inodes) {
      inode.synced = inode.there;
      inode.synced_time = inode.time;
      inode.synced_lists = inode.lists;
    }
    wholes.push_back(image(Names::all, Contents::all));
  }
  ~State() {
    for (const auto& [number, inode] : inodes) ::close(inode.held);
  }
  State(const State&) = delete;
  State& operator=(const State&) = delete;

  /// After a call on this path.
  void changed(const char* call, const std::string& path) {
    if (!is_within(path)) return;
    const bool writes = std::string_view(call).find("write") != std::string_view::npos;
    scan(writes && fs::exists(path) ? fs::path(path) : root, path);
    // Torn contents of what goes on being written are those of a moment before.
    record(std::string(call) + " " + relative(path), writes ? whole_files : torn_ones_too);
  }

  void synced(const char* call, const std::string& path) {
    if (!is_within(path)) return;
    scan(root, path);
    const std::string label = step + ": " + call + " " + masked(relative(path));
    labels.insert(label);
    struct stat status {};
    record("what was before " + label, torn_ones_too);
    if (ignored.contains(label) || ::stat(path.c_str(), &status) != 0) return;
    Inode& inode = inodes.at(status.st_ino);
    inode.synced = inode.there;
    // fdatasync leaves out what reading the bytes does not need.
    if (std::string_view(call) == "fsync") inode.synced_time = inode.time;
    inode.synced_lists = inode.lists;
    record(std::string(call) + " " + relative(path), torn_ones_too);
  }

  void record(const std::string& after, std::span<const Contents> kinds) {
    for (const Contents contents : kinds)
      for (const Names names : {Names::synced, Names::all}) {
        Cut cut{contents, names, ended, !step.empty(), after, image(names, contents)};
        if (met.emplace(cut.steps, cut.during_next, cut.left).second) cuts.push_back(std::move(cut));
      }
  }

  Image image(Names names, Contents contents) {
    Image whole;
    add_to(whole, "", top, names, contents);
    return whole;
  }

  const fs::path root;
  const std::set<std::string> ignored;
  std::set<std::string> labels;
  std::string step;
  std::size_t ended = 0;
  std::vector<Cut> cuts;
  std::vector<Image> wholes;

 private:
  bool is_within(const std::string& path) const { return path == root || path.starts_with(root.native() + "/"); }
  std::string relative(const std::string& path) const {
    return path == root ? "." : path.substr(root.native().size() + 1);
  }

  /// Notes what is there; reads anew what has another time or length, and the file that was touched, since the clock of
  /// a file system is coarse.
  ino_t scan(const fs::path& path, const std::string& touched) {
    struct stat status {};
    if (::lstat(path.c_str(), &status) != 0) throw std::runtime_error("a file vanished while it was looked at");
    Inode& inode = inodes[status.st_ino];
    if (inode.held < 0) inode.held = ::open(path.c_str(), O_PATH | O_NOFOLLOW | O_CLOEXEC);
    inode.is_folder = S_ISDIR(status.st_mode);
    if (inode.is_folder) {
      std::map<std::string, ino_t> lists;
      for (const fs::directory_entry& entry : fs::directory_iterator(path))
        if (!is_left_out(entry.path().filename())) lists[entry.path().filename()] = scan(entry.path(), touched);
      inodes.at(status.st_ino).lists = std::move(lists);
    } else if (!inode.there || inode.time != time_of(status) || path == touched ||
               inode.there->size() != static_cast<std::size_t>(status.st_size)) {
      std::string bytes(static_cast<std::size_t>(status.st_size), '\0');
      std::ifstream(path, std::ios::binary).read(bytes.data(), status.st_size);
      inode.there = kept(std::move(bytes));
    }
    inodes.at(status.st_ino).time = time_of(status);
    return status.st_ino;
  }

  /// The one object for these bytes.
  Bytes kept(std::string bytes) {
    Bytes& one = all_bytes[bytes];
    if (!one) one = std::make_shared<const std::string>(std::move(bytes));
    return one;
  }

  Bytes torn(const Bytes& synced, const Bytes& there) {
    const auto [old, fresh] = std::mismatch(synced->begin(), synced->end(), there->begin(), there->end());
    const auto same = static_cast<std::size_t>(fresh - there->begin());
    const std::size_t middle = (same + there->size()) / 2;
    std::string bytes = there->substr(0, middle);
    if (middle < synced->size()) bytes += synced->substr(middle);
    return kept(std::move(bytes));
  }

  void add_to(Image& image, const std::string& name, ino_t number, Names names, Contents contents) {
    const Inode& inode = inodes.at(number);
    if (inode.is_folder) {
      if (!name.empty()) image.entries[name] = {nullptr, 0};
      for (const auto& [child, of_child] : names == Names::synced ? inode.synced_lists : inode.lists)
        add_to(image, name.empty() ? child : name + "/" + child, of_child, names, contents);
      return;
    }
    const Bytes synced = inode.synced ? inode.synced : kept({});
    Image::Entry& entry = image.entries[name];
    entry.bytes = contents == Contents::synced ? synced
                  : contents == Contents::torn ? torn(synced, inode.there)
                                               : inode.there;
    entry.time = contents == Contents::all ? inode.time : inode.synced_time;
  }

  ino_t top = 0;
  std::map<ino_t, Inode> inodes;
  std::map<std::string, Bytes> all_bytes;
  std::set<std::tuple<std::size_t, bool, Image>> met;
};

namespace {

thread_local LossyDisk::State* watching = nullptr;
thread_local bool looking = false;  // what the disk itself does is not watched

template <typename F>
void tell(const F& f) {
  if (watching == nullptr || looking) return;
  const int error = errno;
  looking = true;
  f(*watching);
  looking = false;
  errno = error;
}

std::string path_of(int descriptor) {
  std::array<char, 4096> path{};
  const ssize_t length = ::readlink(("/proc/self/fd/" + std::to_string(descriptor)).c_str(), path.data(), path.size());
  return length > 0 ? std::string(path.data(), static_cast<std::size_t>(length)) : std::string();
}

void tell_changed(const char* call, const std::string& path) {
  tell([&](LossyDisk::State& disk) { disk.changed(call, fs::absolute(path)); });
}
void tell_changed(const char* call, int descriptor) {
  tell([&](LossyDisk::State& disk) { disk.changed(call, path_of(descriptor)); });
}

/// The function of the C library that one here stands before.
template <typename Function>
Function* real(const char* name) {
  return reinterpret_cast<Function*>(::dlsym(RTLD_NEXT, name));
}

}  // namespace

LossyDisk::LossyDisk(const fs::path& root, std::set<std::string> ignored)
    : state_(std::make_unique<State>(fs::canonical(root), std::move(ignored))) {
  watching = state_.get();
}

LossyDisk::~LossyDisk() { watching = nullptr; }

void LossyDisk::step(const std::string& name, const std::function<void()>& act) {
  state_->step = name;
  act();
  state_->step.clear();
  ++state_->ended;
  looking = true;
  state_->changed("the end of", state_->root);
  state_->wholes.push_back(state_->image(Names::all, Contents::all));
  looking = false;
}

std::vector<LossyDisk::Cut> LossyDisk::cuts() const {
  std::vector<Cut> sorted = state_->cuts;
  std::ranges::stable_sort(sorted, {}, [](const Cut& cut) { return std::pair(cut.contents, cut.names); });
  return sorted;
}
const std::vector<Image>& LossyDisk::wholes() const { return state_->wholes; }
const std::set<std::string>& LossyDisk::labels() const { return state_->labels; }

void Image::write_to(const fs::path& folder) const {
  for (const auto& [name, entry] : entries) {
    if (!entry.bytes) {
      fs::create_directory(folder / name);
      continue;
    }
    const int file = ::open((folder / name).c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
    const std::array<timespec, 2> times = {timespec{},
                                           timespec{entry.time / 1'000'000'000, entry.time % 1'000'000'000}};
    const bool written =
        ::write(file, entry.bytes->data(), entry.bytes->size()) == static_cast<ssize_t>(entry.bytes->size()) &&
        ::futimens(file, times.data()) == 0;
    ::close(file);
    if (!written) throw std::runtime_error("an image cannot be written");
  }
}

}  // namespace spherule::server::test

// The C library's functions that change a disk, for all of this program. What is not here is seen at the next that is.
extern "C" {

using spherule::server::test::real;
using spherule::server::test::tell;
using spherule::server::test::tell_changed;

static int tell_opened(const char* path, int flags, int file) {
  if (file >= 0 && (flags & (O_CREAT | O_TRUNC)) != 0 && (flags & O_TMPFILE) != O_TMPFILE) tell_changed("open", path);
  return file;
}
static mode_t mode_of(int flags, va_list rest) {
  return (flags & (O_CREAT | O_TMPFILE)) != 0 ? va_arg(rest, mode_t) : 0;
}

int open(const char* path, int flags, ...) {
  static auto* const next = real<int(const char*, int, mode_t)>("open");
  va_list rest;
  va_start(rest, flags);
  const mode_t mode = mode_of(flags, rest);
  va_end(rest);
  return tell_opened(path, flags, next(path, flags, mode));
}
int open64(const char* path, int flags, ...) {
  static auto* const next = real<int(const char*, int, mode_t)>("open64");
  va_list rest;
  va_start(rest, flags);
  const mode_t mode = mode_of(flags, rest);
  va_end(rest);
  return tell_opened(path, flags, next(path, flags, mode));
}

ssize_t write(int file, const void* bytes, size_t count) {
  static auto* const next = real<ssize_t(int, const void*, size_t)>("write");
  const ssize_t put = next(file, bytes, count);
  tell_changed("write", file);
  return put;
}
ssize_t writev(int file, const iovec* pieces, int count) {
  static auto* const next = real<ssize_t(int, const iovec*, int)>("writev");
  const ssize_t put = next(file, pieces, count);
  tell_changed("writev", file);
  return put;
}
ssize_t pwrite(int file, const void* bytes, size_t count, off_t at) {
  static auto* const next = real<ssize_t(int, const void*, size_t, off_t)>("pwrite");
  const ssize_t put = next(file, bytes, count, at);
  tell_changed("pwrite", file);
  return put;
}
ssize_t pwrite64(int file, const void* bytes, size_t count, off64_t at) { return pwrite(file, bytes, count, at); }

int ftruncate(int file, off_t size) noexcept {
  static auto* const next = real<int(int, off_t)>("ftruncate");
  const int result = next(file, size);
  tell_changed("ftruncate", file);
  return result;
}
int ftruncate64(int file, off64_t size) noexcept { return ftruncate(file, size); }

int fsync(int file) {
  static auto* const next = real<int(int)>("fsync");
  tell([&](auto& disk) { disk.synced("fsync", spherule::server::test::path_of(file)); });
  return next(file);
}
int fdatasync(int file) {
  static auto* const next = real<int(int)>("fdatasync");
  tell([&](auto& disk) { disk.synced("fdatasync", spherule::server::test::path_of(file)); });
  return next(file);
}

int rename(const char* from, const char* to) noexcept {
  static auto* const next = real<int(const char*, const char*)>("rename");
  const int result = next(from, to);
  tell_changed("rename", to);
  return result;
}
int link(const char* from, const char* to) noexcept {
  static auto* const next = real<int(const char*, const char*)>("link");
  const int result = next(from, to);
  tell_changed("link", to);
  return result;
}
int unlink(const char* path) noexcept {
  static auto* const next = real<int(const char*)>("unlink");
  const int result = next(path);
  tell_changed("unlink", path);
  return result;
}
int remove(const char* path) noexcept {
  static auto* const next = real<int(const char*)>("remove");
  const int result = next(path);
  tell_changed("remove", path);
  return result;
}
int mkdir(const char* path, mode_t mode) noexcept {
  static auto* const next = real<int(const char*, mode_t)>("mkdir");
  const int result = next(path, mode);
  tell_changed("mkdir", path);
  return result;
}
int futimens(int file, const timespec times[2]) noexcept {
  static auto* const next = real<int(int, const timespec*)>("futimens");
  const int result = next(file, times);
  tell_changed("futimens", file);
  return result;
}
}
