// SPDX-License-Identifier: GPL-3.0-or-later
//
// Is everything there that the catalogue says, as it was written, and nothing else? And copies of it all.
//
// A data folder holds catalog.sqlite (what there is), blobs/ (the bytes, named with their SHA-256) and audit.log. A
// backup is a data folder, too: the same catalogue and blobs, without the audit log.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace spherule::server {

struct Finding {
  enum class Kind : std::uint8_t {
    missing_catalogue,  ///< there are blobs, but no catalogue; `what` is empty
    damaged_catalogue,  ///< SQLite's check fails; `what` is empty
    lost_row,           ///< of a damaged catalogue: could not be read; `what` is how many
    damaged_record,     ///< what the catalogue says of a resource cannot be read; `what` is its id
    damaged_job,        ///< nor what it says of a job; `what` is its id
    damaged_file,       ///< an unfinished upload, or a reply under an idempotency key; `what` is folder and name
    missing_blob,       ///< the catalogue names it, and it is not there; `what` is the resource's id
    damaged_blob,       ///< its bytes do not have their digest; `what` is the resource's id
    recovered_blob,     ///< it was in damaged/, and is back; `what` is the resource's id
    unowned_blob,       ///< nothing in the catalogue names it; `what` is its key
  };
  Kind kind;
  std::string what;
};
std::string_view to_string(Finding::Kind kind);

struct StoreReport {
  std::vector<Finding> findings;
  std::uint64_t resources = 0, blobs = 0, bytes = 0;  ///< that are good, after the repair if there was one
};

/// Compares catalogue and blobs of a data folder that no server uses, reading every byte. With `repair`:
///
/// - a damaged catalogue is replaced by one of the rows that can still be read, a missing one by an empty one;
/// - blobs that are missing and lie in `damaged/`, whole, come back: a server that met another catalogue moved them;
/// - resources with a damaged record, or a missing or damaged blob, leave the catalogue, with all that was made from
///   them: the same upload, or the same request, then makes them anew;
/// - records of jobs that cannot be read leave it, too;
/// - blobs that nothing names any more, damaged ones, damaged records and files, and the damaged catalogue move to
///   `damaged/` in the data folder. Nothing but a job's record is deleted.
///
/// Throws busy when a server uses the folder, not_found when it has neither catalogue nor blobs, and corrupt when the
/// catalogue is beyond reading (then only a backup helps).
StoreReport check_store(const std::filesystem::path& data, bool repair);

/// Copies catalogue and blobs to a folder that has neither, also while a server uses `from`: the catalogue as it is at
/// one moment, then its blobs (as hard links where both folders are on one file system: blobs never change), then reads
/// the whole copy back. What was deleted meanwhile, or is damaged, is left out of the copy and is among the findings.
/// The copy has a catalog.sqlite only once it is complete. Throws conflict when `to` is in use already, not_found when
/// `from` has no catalogue, no_space.
StoreReport copy_store(const std::filesystem::path& from, const std::filesystem::path& to);

}  // namespace spherule::server
