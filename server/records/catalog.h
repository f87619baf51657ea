// SPDX-License-Identifier: GPL-3.0-or-later
//
// What the server knows, in one SQLite file (the only user of SQL). Two kinds of rows: resources, which are immutable
// and content-addressed (volumes, models, answers derived from them), and jobs. Documents of resources are opaque text
// here; the requests of jobs are written and read as their records (api/json/work.h). A function that changes something
// has made it durable when it returns.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "api/jobs.h"
#include "api/things.h"
#include "core/base/error.h"
#include "server/base/clock.h"
#include "server/bytes/blob_store.h"

namespace spherule::server {

/// A thing under an id: a volume, a model, a cached answer.
struct Resource {
  std::string id;                   ///< content_id: equal ids are equal things
  std::string collection;           ///< "volumes", "models", …: what lists go by
  Time created{};                   ///< set by the catalogue
  Time used{};                      ///< set by the catalogue: when, by Catalog::served(), it or something made from it
                                    ///< was last used
  std::string request;              ///< canonical text of what was asked, if anything
  std::string document;             ///< whatever the api layer wants to find again
  std::vector<std::string> inputs;  ///< ids of the resources that it was made from; deleted together with any of them
  std::vector<std::string> blobs;   ///< keys in the blob store, in the owner's order
  std::uint64_t bytes = 0;          ///< of all blobs together
};

using api::is_over;
using api::JobError;
using api::JobState;
using api::Page;

/// What survives of a job; of the moment it tells nothing.
struct JobRecord : api::JobInfo {
  std::string client{};                ///< whose turn it takes: the name of a key
  std::uint64_t memory_bytes = 0;      ///< estimate of what it needs at its peak
  std::set<std::string> requesters{};  ///< clients that still want it
  unsigned attempts = 1;               ///< how many servers took it up: 1 + restarts while it was not over
  unsigned crashes = 0;                ///< how often the process died while it ran
};

/// Thread safe: one connection that writes (WAL, synchronous=FULL, foreign keys) and a few that read, which never wait
/// for it. A read sees what was written before it began. Every function may throw corrupt (the file is damaged),
/// no_space (the disk is full; nothing has changed) and busy (the file is locked).
///
/// Two times: created, started and finished are by the clock on the wall, for people to read. How long something was
/// not used, or a job has been over, is counted in time of service, which goes on only while a server has the catalogue
/// open: no clock that is set wrong, and no month in a cupboard, makes anything old.
class Catalog {
 public:
  /// Opens or makes the file, for its owner's eyes only (of one that is there the permissions are mended), brings its
  /// schema up to date and locks it (by `<file>.lock`) for this object until destroyed or killed; copy_catalog() reads
  /// it all the same. Throws busy when it is locked, corrupt when it is no catalogue or fails SQLite's check, conflict
  /// when a newer version of this program wrote it.
  explicit Catalog(const std::filesystem::path& file, Clocks clocks = {});
  ~Catalog();
  Catalog(const Catalog&) = delete;
  Catalog& operator=(const Catalog&) = delete;

  /// Keeps a few MiB of the disk (as `<file>.room`, where its file system can) for erase() on a disk that is full, and
  /// for opening the catalogue there. Without effect when there is no room.
  void reserve_room();

  /// The time of service. It began as the wall's time, never goes back and never jumps; what the last process had
  /// served since its last note_time() may be missing.
  [[nodiscard]] Time served() const;

  /// Writes the time of service down, and returns by how much more the clock on the wall has moved since the last time
  /// that it was: it was set, or no server ran.
  std::chrono::microseconds note_time();

  /// False, without effect, when the id is there already. Throws conflict when an input is not (any more).
  bool add(const Resource& resource);

  [[nodiscard]] std::optional<Resource> find(const std::string& id) const;

  /// Whether there is a resource of this collection under this id, readable or not.
  [[nodiscard]] bool holds(const std::string& id, const std::string& collection) const;

  /// `cursor` is empty or a page's `next`; anything else throws invalid_argument. At least one item a page. O(page).
  [[nodiscard]] Page<Resource> list(const std::string& collection, const std::string& cursor, std::size_t limit) const;

  /// As list(), of every collection.
  [[nodiscard]] Page<Resource> list_all(const std::string& cursor, std::size_t limit) const;

  /// Sets `used` of the resource, and of all that it was made from, to served(). Without effect when it is not there.
  void touch(const std::string& id);

  /// Ids of at most `limit` resources of a collection that were last used before `before`, longest unused first.
  [[nodiscard]] std::vector<std::string> unused_since(const std::string& collection, Time before,
                                                      std::size_t limit) const;

  /// Ids of resources of a collection, longest unused first, whose going leaves at most `most` bytes of it. O(what is
  /// kept of the collection), from an index.
  [[nodiscard]] std::vector<std::string> over_budget(const std::string& collection, std::uint64_t most) const;

  /// Deletes the resource and everything made from it, also on a full disk (reserve_room()), and returns the blob keys
  /// to be removed now. `before` is handed the keys just before they lose their owner. Throws not_found.
  using BeforeErasing = std::function<void(const std::vector<std::string>& keys)>;
  [[nodiscard]] std::vector<std::string> erase(const std::string& id, const BeforeErasing& before = {});

  /// Whether some resource owns this blob.
  [[nodiscard]] bool owns_blob(const std::string& key) const;

  // Jobs; JobPool is the only caller. Each function is one transaction.
  void add_job(const JobRecord& job);

  /// Replaces everything but id, kind, result_id, request and created.
  void update_job(const JobRecord& job);

  /// As update_job for a job that succeeded, and adds its result in the same transaction, so that neither is ever seen
  /// without the other. False when the result was there already (its blobs are then not needed). Throws conflict,
  /// changing nothing, when an input was deleted meanwhile.
  bool complete_job(const JobRecord& job, const Resource& result);

  [[nodiscard]] std::optional<JobRecord> find_job(const std::string& id) const;
  [[nodiscard]] Page<JobRecord> list_jobs(const std::string& cursor, std::size_t limit) const;

  /// Jobs that are not over, oldest first; those whose rows cannot be read are left out.
  [[nodiscard]] std::vector<JobRecord> unfinished_jobs() const;

  /// Deletes the records of jobs that ended before this time of service; returns how many.
  std::size_t forget_jobs(Time ended_before);

  /// Ids of jobs whose rows cannot be read. O(jobs).
  [[nodiscard]] std::vector<std::string> damaged_jobs() const;
  /// Deletes the record of a job, whatever its state. Without effect when there is none.
  void forget_job(const std::string& id);

  /// SQLite's full check and that of the references between tables; a connection has had the quick one. O(file).
  /// Throws corrupt when it finds anything.
  void verify() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// Copies a catalogue, also one that a server is using, as it is at one moment (SQLite's online backup) to a file that
/// is not there yet. Throws what Catalog throws.
void copy_catalog(const std::filesystem::path& from, const std::filesystem::path& to);

struct Salvage {
  std::size_t resources = 0, jobs = 0;  ///< that could be read and are in the new catalogue
  std::size_t lost = 0;                 ///< rows at most that could not be read, or whose inputs could not
};

/// Reads what is readable of a damaged catalogue, row by row, into a new one in `to`, which must not be there.
/// Throws corrupt when not even its schema can be read, and busy when it is locked.
Salvage salvage_catalog(const std::filesystem::path& damaged, const std::filesystem::path& to);

/// Adds a resource whose blobs are committed. When the id is there already (returns false) or adding fails (throws),
/// the given blobs are removed again (at the latest by the next start), so the caller owns nothing afterwards.
bool publish(Catalog& catalog, BlobStore& blobs, const Resource& resource);

/// For blobs that have got an owner: BlobStore::settle of each.
void settle_all(BlobStore& blobs, const std::vector<std::string>& keys);

/// Deletes a resource, everything made from it, and their blobs; returns the blobs' keys when the catalogue has
/// forgotten them for good. Throws not_found.
std::vector<std::string> withdraw(Catalog& catalog, BlobStore& blobs, const std::string& id);

/// Sorts out the blobs that nothing owns. Those that were on their way in or out when a process ended
/// (BlobStore::unsettled) are removed. All others are not understood: `set_aside` is called for each, which moves it.
/// Throws corrupt, having changed nothing, when these outnumber the blobs that have an owner: then the catalogue is
/// missing, or older than the blobs. Only before anything is served: a blob on its way to being published would look
/// the same.
void sort_out_orphans(const Catalog& catalog, BlobStore& blobs,
                      const std::function<void(const std::string& key)>& set_aside);

/// The Error for blobs that the catalogue does not know.
[[noreturn]] void throw_lost_catalogue();

}  // namespace spherule::server
