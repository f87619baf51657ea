// SPDX-License-Identifier: GPL-3.0-or-later
//
// What the REST interface asks of the program behind it, in the program's own words. server/pipeline.* implements it;
// tests of api/ stand a stub here. It knows no HTTP and no JSON.
//
// Every method is thread safe and throws Error and nothing else for anything that input, limits or the outside world
// can cause: not_found for an id that nothing bears, whatever the id looks like.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "api/jobs.h"
#include "api/things.h"
#include "api/work.h"
#include "core/measure/report.h"
#include "core/write/export.h"

namespace spherule::api {

// ---------------------------------------------------------------------------------------------------------- contents

/// Open, immutable bytes. They stay readable while this is held, also when what they belong to is deleted.
struct Content {
  std::uint64_t bytes = 0;
  std::string sha256;  ///< lower-case hex
  /// Fills `out` from `offset` on; returns how many bytes there were: fewer than asked only at the end. Thread safe.
  std::function<std::size_t(std::uint64_t offset, std::span<char> out)> read_at;
  int file = -1;  ///< a descriptor of just these bytes, open as long as read_at lives; -1: none
};

/// Files on their way in. What was begun and not stored vanishes with the object.
class Upload {
 public:
  virtual ~Upload() = default;
  /// Starts the next file. `name` may be a path of the sender: what follows its last slash is kept. Throws
  /// invalid_argument for a name that occurs twice and for too many files.
  virtual void begin_file(std::string_view name) = 0;
  /// Appends to the file begun last. Throws no_space.
  virtual void write(std::string_view piece) = 0;
};

/// Whether nobody waits for an answer any more; asked now and then, from any thread. May be empty.
using Gone = std::function<bool()>;

/// Rows of a listing.
struct SpherePage {
  std::uint64_t total = 0;
  std::vector<Sphere> spheres;
  std::vector<SphereColumn> columns;  ///< as listed
  /// Of each sphere, when they were asked for: ascending indices of spheres of the source model.
  std::optional<std::vector<std::vector<std::uint32_t>>> members;
};

// ----------------------------------------------------------------------------------------------------- what comes back

/// A thing as it is stored now.
template <typename T>
struct Stored {
  T thing;
  bool already_stored = false;  ///< before the request that gives it
};

/// What a request made: what WorkRequest's kind makes; the bytes of what is derived.
using Made = std::variant<Stored<ModelInfo>, Stored<RegistrationInfo>, Content>;

/// A result, or the job that will make it.
using Outcome = std::variant<Made, JobInfo>;

// ------------------------------------------------------------------------------------------------------ of the program

struct Limits {
  std::uint64_t upload_bytes = 0;        ///< of one request's body
  std::uint64_t image_pixels = 0;        ///< of one picture
  std::chrono::seconds longest_wait{0};  ///< of `Prefer: wait` and of derived answers
};

struct Readiness {
  bool ready = false;
  std::string reason;  ///< a sentence that says why not
};

struct About {
  std::string version;            ///< of the program
  std::string algorithm_version;  ///< of the models: part of their identity
};

/// An upload that is sent in pieces (tus).
struct UploadInfo {
  std::string id;
  std::string filename;                  ///< empty when none was given
  std::uint64_t length = 0, offset = 0;  ///< bytes: announced; arrived so far
  Time created, expires;
};

/// A family of figures, as Prometheus has them.
struct Metric {
  struct Sample {
    std::string suffix;  ///< "_bucket", "_sum", "_count" of a histogram, else empty
    std::vector<std::pair<std::string, std::string>> labels;
    double value = 0;
  };
  std::string name, type, help;  ///< type: "counter", "gauge" or "histogram"
  std::vector<Sample> samples;
};

/// Uploads that are sent in pieces, as a client keeps them.
class PartialUploads {
 public:
  virtual ~PartialUploads() = default;
  using TakeBytes = std::function<void(std::string_view piece)>;

  /// Begins one. Throws too_large, busy, no_space.
  virtual UploadInfo create(std::uint64_t length, std::string_view filename) = 0;
  virtual UploadInfo find(const std::string& id) const = 0;
  /// Appends what `feed` hands on; what has arrived stays, also when `feed` throws. Throws conflict when the upload
  /// does not stand at `offset`, too_large for more bytes than were announced.
  virtual UploadInfo append(const std::string& id, std::uint64_t offset,
                            const std::function<void(const TakeBytes&)>& feed) = 0;
  /// Hands on all bytes of a finished upload. Throws conflict while some are missing.
  virtual void read(const std::string& id, const TakeBytes& take) const = 0;
  virtual void remove(const std::string& id) = 0;
};

/// Replies that are kept under keys of the caller's choice, to be given again (Idempotency-Key).
class Replies {
 public:
  virtual ~Replies() = default;

  /// The reply that was kept under a key, if any; else the key is the caller's until it keeps a reply or releases it.
  /// Throws conflict while it is another caller's.
  virtual std::optional<std::string> recall(const std::string& key) = 0;
  virtual void keep(const std::string& key, const std::string& reply) = 0;
  virtual void release(const std::string& key) = 0;
};

class Service {
 public:
  using Seconds = std::chrono::duration<double>;

  virtual ~Service() = default;

  virtual About about() const = 0;
  virtual Limits limits() const = 0;
  virtual Readiness readiness() const = 0;
  virtual std::vector<Metric> metrics() = 0;

  /// Begins an upload of `announced` bytes (0: unknown). Throws no_space when they cannot fit, busy.
  virtual std::unique_ptr<Upload> start_upload(std::uint64_t announced) = 0;
  /// Reads the uploaded files as a volume and keeps them: on the disk before this returns. Throws what read_volume
  /// throws, invalid_argument without any file, cancelled when the sender is gone, and busy when the server stops.
  virtual Stored<VolumeInfo> store_volume(std::unique_ptr<Upload> upload, const VolumeParameters& parameters,
                                          const Gone& gone) = 0;
  /// A model of spheres that the user brings, in one uploaded file.
  virtual Stored<ModelInfo> import_model(std::unique_ptr<Upload> upload, SphereFormat format) = 0;

  virtual Thing find(Collection collection, const std::string& id) = 0;
  virtual Page<Thing> list(Collection collection, const PageRequest& page) = 0;
  /// Deletes a thing with all that was made from it, and ends the jobs that work on any of these.
  virtual void remove(Collection collection, const std::string& id) = 0;
  template <typename T>
  T find(const std::string& id) {
    return std::get<T>(find(collection_of<T>, id));
  }

  /// The bytes of a volume's file number `index` as they came. Throws not_found for an index past the last.
  virtual Content content(const std::string& volume, std::size_t index) = 0;
  /// Rows of a listing of a model's spheres, of a level as in DerivedRequest; `members` of each row too where wanted.
  /// Throws not_found when it needs contributions and no ContributionsRequest has made them, unusable when only
  /// simplified models have what it needs.
  virtual SpherePage spheres(const std::string& model, std::uint32_t level, std::uint64_t offset, std::size_t limit,
                             const SphereListing& listing, bool members) = 0;
  virtual RadiusHistogram radius_histogram(const std::string& model, std::size_t buckets, RadiusScale scale) = 0;

  /// What the request makes: at once when it exists, else a job is started (or the one that runs already is joined) and
  /// waited for at most `wait`. Throws the job's error when it fails in that time; not_found without what the request
  /// is made from; busy when the queue is full; what check_method throws; unusable for measures, checks and files that
  /// the model's kind or size does not have, and for volumes where a registered model was not made from one;
  /// invalid_argument for a level that the model does not have.
  virtual Outcome submit(const WorkRequest& request, Seconds wait) = 0;

  virtual Page<JobInfo> jobs(const PageRequest& page) = 0;
  virtual JobInfo job(const std::string& id) = 0;
  /// Events after number `after`, as soon as there are any; none when `wait` passes first or the server stops.
  virtual JobEvents job_events(const std::string& id, std::uint64_t after, Seconds wait) = 0;
  /// Takes the caller's request for the job back; the last one stops the work. Who may do everything stops it for all,
  /// once it is none of the requesters. Nothing when the caller may not. Throws conflict when the job is over.
  virtual std::optional<JobInfo> cancel_job(const std::string& id) = 0;

  virtual PartialUploads& partial_uploads() = 0;
  virtual Replies& replies() = 0;
};

}  // namespace spherule::api
