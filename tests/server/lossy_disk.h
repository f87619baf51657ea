// SPDX-License-Identifier: GPL-3.0-or-later
//
// A disk that loses what was not synchronised. It watches the calls by which a thread changes a folder (the program's,
// and those of the libraries that it is linked to dynamically: the test program stands before the C library), and keeps
// what each file held and each folder listed when it was last synchronised. From these come the folders that a power
// cut may leave after any of the calls. The idea is that of LevelDB's FaultInjectionTestEnv.
#pragma once

#include <compare>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

namespace spherule::server::test {

/// A folder with all that is in it, by path relative to it.
struct Image {
  struct Entry {
    std::shared_ptr<const std::string> bytes;  ///< null for a folder; equal ones of one disk are one object
    std::int64_t time = 0;                     ///< of its last change, ns; 0 when not synchronised
    auto operator<=>(const Entry&) const = default;
  };
  std::map<std::string, Entry> entries;
  auto operator<=>(const Image&) const = default;

  /// Makes it in `folder`, which is empty.
  void write_to(const std::filesystem::path& folder) const;
};

/// One at a time in a thread, whose calls it watches.
///
/// Of names (what folders list) and contents, a cut leaves either what was synchronised or what was there; of contents
/// also all up to the middle of what was not. A file never has bytes that nobody wrote: as with ext4, XFS and Btrfs, it
/// gets its length when they are written. Files that end in -shm, which SQLite shares as memory, are left out.
class LossyDisk {
 public:
  /// What is in `root` counts as synchronised. `ignored` are labels of calls of fsync and fdatasync that do nothing.
  explicit LossyDisk(const std::filesystem::path& root, std::set<std::string> ignored = {});
  ~LossyDisk();
  LossyDisk(const LossyDisk&) = delete;
  LossyDisk& operator=(const LossyDisk&) = delete;

  /// One call, whose end acknowledges what it did.
  void step(const std::string& name, const std::function<void()>& act);

  enum class Names { synced, all };           ///< of a folder's names
  enum class Contents { synced, torn, all };  ///< of a file's bytes
  struct Cut {
    Contents contents{};
    Names names{};
    std::size_t steps = 0;     ///< that had ended
    bool during_next = false;  ///< whether the next had begun
    std::string after;         ///< the call of the system that was the last
    Image left;
  };
  /// What cuts may leave, ordered by contents and names, each different one once.
  [[nodiscard]] std::vector<Cut> cuts() const;

  /// What was there before the first step and after each.
  [[nodiscard]] const std::vector<Image>& wholes() const;

  /// "<step>: fsync <path>" of each synchronisation, with # in place of random digits.
  [[nodiscard]] const std::set<std::string>& labels() const;

  struct State;

 private:
  std::unique_ptr<State> state_;
};

}  // namespace spherule::server::test
