// SPDX-License-Identifier: GPL-3.0-or-later
//
// What is kept, in the terms of core/: volumes, models and the measures of their unions, over the catalogue, the blobs
// and the memory cache. Everything that serves or computes goes through it.
#pragma once

#include <chrono>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <semaphore>
#include <string>
#include <vector>

#include "api/service.h"
#include "core/base/context.h"
#include "core/measure/union.h"
#include "core/simplify/result.h"
#include "core/spheres.h"
#include "core/volume.h"
#include "server/base/cache.h"
#include "server/bytes/aside.h"
#include "server/bytes/blob_store.h"
#include "server/config.h"
#include "server/records/catalog.h"
#include "server/records/listing.h"
#include "server/records/retention.h"

namespace spherule::server {

// Collections of the catalogue.
inline constexpr const char* volumes_collection = "volumes";
inline constexpr const char* models_collection = "models";
inline constexpr const char* registrations_collection = "registrations";
inline constexpr const char* answers_collection = "answers";

/// Of the algorithms, as it enters ids.
std::string algorithm_version_text();

/// Throws not_found with the sentence for a missing `what` ("model").
[[noreturn]] void not_found(const char* what);

/// Stored bytes as the interface hands them out.
api::Content content_of(const std::shared_ptr<const Blob>& blob);

/// Seconds of each stage, by name.
class Stopwatch {
 public:
  void lap(const std::string& stage);
  void set(const std::string& stage, double seconds) { seconds_[stage] = seconds; }
  void restart() { last_ = std::chrono::steady_clock::now(); }
  const std::map<std::string, double>& seconds() const { return seconds_; }

 private:
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
  std::map<std::string, double> seconds_;
};

/// Null where a listing does not need it.
struct ListedParts {
  std::shared_ptr<const Simplification> levels;
  std::shared_ptr<const SphereModel> source;  ///< that the model was simplified from
};

/// Thread safe. Ids that nothing bears throw not_found; damaged bytes throw corrupt.
struct Store {
  /// Told what is moved to damaged/, by its name there.
  using AsideLog = std::function<void(const std::string& name)>;
  /// Told which answers are deleted to make room for others.
  using ExpiryLog = std::function<void(const std::string& id)>;

  /// Opens the store in config.data (made if needed) and sorts out its blobs (sort_out_orphans). All that it makes is
  /// for its owner's eyes only, and what an earlier version made is mended. Throws busy when another process uses that
  /// folder, corrupt when the catalogue is missing or older than the blobs, and what Catalog and FileBlobStore throw.
  explicit Store(const Config& given, AsideLog aside = {}, ExpiryLog expiry = {});

  /// Held while a whole volume or model is read beside the jobs: as many at once as jobs. Throws cancelled instead of
  /// waiting on.
  class Permit {
   public:
    Permit(Store& store, const Context& context) : store_(store) {
      constexpr std::chrono::milliseconds look{20};
      while (!store_.heavy.try_acquire_for(look)) context.throw_if_cancelled();
    }
    ~Permit() { store_.heavy.release(); }
    Permit(const Permit&) = delete;
    Permit& operator=(const Permit&) = delete;

   private:
    Store& store_;
  };

  /// Finding is using: it is noted for the retention, where there is one.
  std::optional<Resource> find_any(const std::string& id);
  Resource find(const std::string& id, const char* collection, const char* what);
  Resource find_volume(const std::string& id) { return find(id, volumes_collection, "volume"); }
  Resource find_model(const std::string& id) { return find(id, models_collection, "model"); }
  api::RegistrationInfo find_registration(const std::string& id);
  /// The model that a chain of simplifications began with: `model` itself when it is none.
  Resource root_of(Resource model);

  /// Deletes the resource, all that was made from it, and their blobs. Throws not_found.
  void remove(const std::string& id);
  /// Throws not_found unless there is such a resource of this collection; its record need not be readable.
  void require(const std::string& id, const char* collection, const char* what) const;

  /// The blob of a key, its digest verified. The last few hundred stay open, and are not verified again: damage that
  /// happens to a file while it is among them is found by the next start, or by fsck.
  std::shared_ptr<const Blob> intact(const std::string& key);

  /// For what keeps files of its own in the data folder.
  Surroundings surroundings();

  /// Stores the bytes of an answer, for whose sake the least recently used answers go where they would be too many (to
  /// the hour, which is how exactly uses are noted; the newest stays, however large). Returns the key.
  std::string put_answer(const std::string& id, std::string_view bytes);

  /// How long things are kept, as configured.
  std::vector<Keeping> keeping() const;

  /// Reads files of these names; a single one needs none. `open` gives the bytes of each, by its number, and is called
  /// once for each. `admit` as of ReadLimits.
  Volume read(const std::vector<api::StoredFile>& files, const std::function<Blob(std::size_t file)>& open,
              const api::VolumeParameters& parameters, const Context& context,
              std::function<void(std::size_t bytes)> admit = {}) const;
  Volume stored_volume(const Resource& resource, const Context& context) const;

  // In what follows, `level` is that of api::DerivedRequest: 0 for the whole model.

  /// Hears what something will take in memory before it is read from the disk, and may throw.
  using Admit = std::function<void(std::uint64_t bytes)>;

  /// The model, from memory or the disk.
  std::shared_ptr<const SphereModel> load(const Resource& resource, const Context& context, const Admit& admit = {});
  std::shared_ptr<const SphereModel> load(const Resource& resource, std::uint32_t level, const Context& context,
                                          const Admit& admit = {});
  /// The levels of a simplified model, likewise.
  std::shared_ptr<const Simplification> load_levels(const Resource& resource, const Context& context,
                                                    const Admit& admit = {});
  /// What rows of a listing need of a model beside its spheres and contributions.
  ListedParts listed_parts(const Resource& resource, const api::SphereListing& listing, bool members,
                           const Context& context, const Admit& admit = {});
  /// Makes the model's blob durable and describes it as a resource.
  Resource keep(api::ModelInfo& info, SphereModel&& model, Stopwatch& watch, const Context& context);
  Resource keep(api::ModelInfo& info, const Simplification& levels, Stopwatch& watch, const Context& context);

  static std::string contributions_id(const std::string& model, std::uint32_t level);
  UnionMeasures read_union_of(const Resource& answer, const SphereModel& model, const Context& context) const;
  /// Makes the measures of a model's union durable and describes them as a resource.
  Resource keep(const std::string& model, std::uint32_t level, const UnionMeasures& whole);
  /// As kept, or measured and kept: several answers need it, and it takes longest.
  UnionMeasures union_of(const Resource& resource, std::uint32_t level, const SphereModel& model,
                         const Context& context);

  Config config;
  AsideLog aside_log;
  ExpiryLog expiry_log;
  Catalog catalog;  // its lock comes before anything else is touched
  FileBlobStore blobs;
  Cache<SphereModel> cache;
  Cache<Simplification> levels;
  Cache<Contributions> contributions;
  Cache<Blob> open_blobs;  // counted, not weighed
  std::counting_semaphore<> heavy;

 private:
  Resource keep(api::ModelInfo& info, const std::function<void(const std::function<void(std::string_view)>&)>& write,
                Stopwatch& watch, const Context& context);
  void make_room_for_answer(std::uint64_t bytes);
  bool is_to_be_noted(const Resource& resource) const;
  void put_aside(const std::filesystem::path& file, const std::string& name) noexcept;
};

/// Reads the record of a resource, as serving it would. Throws corrupt.
void check_record(const Resource& resource);

}  // namespace spherule::server
