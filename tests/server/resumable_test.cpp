// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/resumable.h"

#include <gtest/gtest.h>

#include <filesystem>

#include "core/base/error.h"
#include "server/digest.h"
#include "server/replies.h"

namespace spherule::server {
namespace {

using namespace std::chrono_literals;

template <typename F>
std::optional<ErrorCode> refusal(F&& f) {
  try {
    f();
    return std::nullopt;
  } catch (const Error& error) {
    return error.code();
  }
}

class Folder : public testing::Test {
 protected:
  ~Folder() override { std::filesystem::remove_all(folder); }
  // As if nothing had happened to the files of this folder for two hours.
  void age() const {
    for (const auto& entry : std::filesystem::directory_iterator(folder)) {
      std::filesystem::last_write_time(entry.path(), std::filesystem::file_time_type::clock::now() - 2h);
    }
  }
  std::size_t files() const {
    return static_cast<std::size_t>(
        std::distance(std::filesystem::directory_iterator(folder), std::filesystem::directory_iterator()));
  }
  const std::filesystem::path folder = std::filesystem::temp_directory_path() / random_id("resumable");
};

class Resumable : public Folder {
 protected:
  static std::string all_of(const ResumableUploads& uploads, const std::string& id) {
    std::string bytes;
    uploads.read(id, [&](std::string_view piece) { bytes += piece; });
    return bytes;
  }
  static std::function<void(const ResumableUploads::Take&)> bytes(std::string text) {
    return [text = std::move(text)](const ResumableUploads::Take& take) { take(text); };
  }
};

TEST_F(Resumable, GoOnAfterABreakAndARestart) {
  std::string id;
  {
    ResumableUploads uploads(folder, 100, 1h);
    const api::UploadInfo begun = uploads.create(10, "Doe^Jane\n.mhd");
    id = begun.id;
    EXPECT_EQ(begun.length, 10U);
    EXPECT_EQ(begun.offset, 0U);
    EXPECT_EQ(begun.filename, "Doe^Jane_.mhd");
    EXPECT_EQ(uploads.append(id, 0, bytes("0123")).offset, 4U);
    // A connection breaks: what came stays.
    EXPECT_EQ(refusal([&] {
                uploads.append(id, 4, [](const ResumableUploads::Take& take) {
                  take("45");
                  throw Error(ErrorCode::malformed, "The body is cut short.");
                });
              }),
              ErrorCode::malformed);
  }
  ResumableUploads uploads(folder, 100, 1h);
  EXPECT_EQ(uploads.find(id).offset, 6U);
  EXPECT_EQ(uploads.find(id).filename, "Doe^Jane_.mhd");
  EXPECT_EQ(refusal([&] { all_of(uploads, id); }), ErrorCode::conflict) << "not whole yet";
  EXPECT_EQ(refusal([&] { uploads.append(id, 4, bytes("4")); }), ErrorCode::conflict);
  EXPECT_EQ(uploads.append(id, 6, bytes("6789")).offset, 10U);
  EXPECT_EQ(all_of(uploads, id), "0123456789");
  EXPECT_EQ(refusal([&] { uploads.append(id, 10, bytes("x")); }), ErrorCode::too_large);
  EXPECT_EQ(uploads.append(id, 10, bytes("")).offset, 10U);
  uploads.remove(id);
  EXPECT_EQ(files(), 0U);
  EXPECT_EQ(refusal([&] { uploads.find(id); }), ErrorCode::not_found);
}

TEST_F(Resumable, TakeOneAppendAtATime) {
  ResumableUploads uploads(folder, 100, 1h);
  const std::string id = uploads.create(10, "").id;
  uploads.append(id, 0, [&](const ResumableUploads::Take& take) {
    take("01");
    EXPECT_EQ(refusal([&] { uploads.append(id, 2, bytes("2")); }), ErrorCode::conflict);
    EXPECT_EQ(refusal([&] { uploads.remove(id); }), ErrorCode::conflict);
    take("23");
  });
  EXPECT_EQ(uploads.find(id).offset, 4U);
}

TEST_F(Resumable, KeepToTheirLimits) {
  ResumableUploads uploads(folder, 100, 1h, 2);
  EXPECT_EQ(refusal([&] { uploads.create(101, ""); }), ErrorCode::too_large);
  uploads.create(100, "");
  uploads.create(0, "");
  EXPECT_EQ(refusal([&] { uploads.create(1, ""); }), ErrorCode::busy);
}

TEST_F(Resumable, Expire) {
  ResumableUploads uploads(folder, 100, 1h);
  const std::string id = uploads.create(10, "").id;
  age();
  EXPECT_EQ(refusal([&] { uploads.find(id); }), ErrorCode::not_found);
  uploads.create(5, "");
  EXPECT_EQ(files(), 2U) << "what has expired is swept away";
}

TEST_F(Resumable, TakeNoPathsForIds) {
  ResumableUploads uploads(folder, 100, 1h);
  for (const char* id : {"", "upl_", "../upl_00", "upl_0/../0", "upl_zz", "/etc/passwd"}) {
    EXPECT_EQ(refusal([&] { uploads.find(id); }), ErrorCode::not_found) << id;
  }
}

class Replies : public Folder {};

TEST_F(Replies, AreKeptOverRestartsUntilTheyAreOld) {
  {
    ReplyBook book(folder, 1h);
    EXPECT_EQ(book.recall("k"), std::nullopt);
    EXPECT_EQ(refusal([&] { book.recall("k"); }), ErrorCode::conflict) << "another has it";
    EXPECT_EQ(book.recall("other"), std::nullopt);
    book.release("other");
    EXPECT_EQ(book.recall("other"), std::nullopt);
    book.keep("k", std::string("reply\0with\nlines", 16));
    EXPECT_EQ(book.recall("k"), std::string("reply\0with\nlines", 16));
  }
  ReplyBook book(folder, 1h);
  EXPECT_EQ(book.recall("k"), std::string("reply\0with\nlines", 16));
  EXPECT_EQ(book.recall("other"), std::nullopt) << "a reservation ends with the process";
  age();
  EXPECT_EQ(book.recall("k"), std::nullopt);
}

}  // namespace
}  // namespace spherule::server
